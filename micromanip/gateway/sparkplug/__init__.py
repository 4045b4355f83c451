"""The cell as an edge node of MQTT Sparkplug B: births, changes and deaths; it takes no orders."""
