"""Real-time controller for piezo-actuated micro manipulators in robot machining cells."""
