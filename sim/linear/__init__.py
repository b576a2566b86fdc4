"""The exact linear counterpart of the same loop, in time and frequency; without MuJoCo."""
