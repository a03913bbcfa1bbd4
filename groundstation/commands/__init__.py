"""One thin module for each command of covey."""
