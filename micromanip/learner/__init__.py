"""The process that learns from the parts of a running cell: reads its telemetry, keeps its memories."""
