"""Controllers with states: full-order H-infinity, LQR, LQG and H2, and their reduction."""
