"""The own state: believable poses, PX4's local frame, and the poses that PX4 gets."""
