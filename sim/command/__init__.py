"""Parts shared by commands: options, the choice of controllers, logs, and viewers."""
