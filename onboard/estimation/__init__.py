"""Kalman filter of the own motion, disturbance observer, hover thrust; pure."""
