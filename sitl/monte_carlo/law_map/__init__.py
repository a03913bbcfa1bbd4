"""The map of the law: where in delay, loss, speed and number it holds, flown cell by cell."""
