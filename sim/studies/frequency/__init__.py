"""Frequency responses and the H-infinity norm, measured in MuJoCo and compared with linear analysis.

Start with `identification`, which contains `measure_responses`. `worst_case_gain` measures the largest gain, and `sweep`
combines frequency responses, gains and minimum tyre loads. `eusama` simulates the EUSAMA test, and `describing_function`
measures describing functions of nonlinear laws.
"""
