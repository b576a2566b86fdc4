"""A vehicle and its controller as they are built: with lag, with states that are kept, with forces that are held and late."""
