"""What several commands share: their options, the choice of controllers, logs, and viewers."""
