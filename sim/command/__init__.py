"""What commands share: the choice of controllers, common options, outputs, progress."""
