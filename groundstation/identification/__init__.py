"""Parameters of a vehicle (lag, drag, hover throttle, tilt error) from a recorded flight."""
