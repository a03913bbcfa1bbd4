"""PX4 itself as emulated: commander, modes, failsafes, estimator, controllers, parameters."""
