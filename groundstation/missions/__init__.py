"""Missions in flight: the Python API, the runner of mission files, and the landing at the end."""
