"""The driver `modbus`: registers of Modbus TCP and RTU devices, by configuration."""
