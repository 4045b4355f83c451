"""Devices of nobody's making: none of the product's code, habits that are drawn, and outputs that are looked at."""
