"""Hard limits from energy: how far a signal goes for a disturbance of given energy, and designs that keep it within."""
