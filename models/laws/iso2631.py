"""Constants of the frequency weightings W_k and W_d of ISO 2631-1.

W_k is for vertical vibration and W_d for horizontal vibration of seated or standing people. The constants are those of ISO 8041.
With w_i = 2 pi f_i,

    H(s) = 1 / (1 + w1/(Q1 s) + (w1/s)^2) * 1 / (1 + s/(Q2 w2) + (s/w2)^2) * (1 + s/w3) / (1 + s/(Q4 w4) + (s/w4)^2)
           * (1 + s/(Q5 w5) + (s/w5)^2) / (1 + s/(Q6 w6) + (s/w6)^2) * (w5/w6)^2.

W_k and W_d are products of the band limits, the transition from acceleration to velocity, and the upward step. W_d does not
contain the upward step.
"""

import numpy as np

F1, F2, F3, F4, F5, F6 = 0.4, 100.0, 12.5, 12.5, 2.37, 3.35  # constants of the filter W_k [Hz]
Q1, Q2, Q4, Q5, Q6 = 1 / np.sqrt(2), 1 / np.sqrt(2), 0.63, 0.91, 0.91
HORIZONTAL = 2.0  # the filter W_d has this frequency instead of f3 and f4 [Hz]
