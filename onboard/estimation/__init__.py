"""Kalman filter of the vehicle's motion, disturbance observer, hover thrust, wind. Pure."""
