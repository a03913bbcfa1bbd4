"""The vehicle's own position: checked poses, PX4's local frame, and the poses sent to PX4."""
