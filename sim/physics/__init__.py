"""The MuJoCo response of N runs, and its energy balance."""
