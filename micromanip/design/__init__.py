"""Identification, synthesis and evaluation: plain functions on arrays, offline."""
