"""Code that several commands share: options, the choice of controllers, logs, and viewers."""
