"""Missions: files, the mission API, and the verdict."""
