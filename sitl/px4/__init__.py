"""Emulation of PX4: commander, modes, failsafes, estimator, controllers, parameters."""
