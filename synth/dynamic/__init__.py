"""Controllers with states of their own: the full-order H-infinity design, LQR, LQG and H2, and laws with an estimator."""
