"""Widgets of the console; each draws itself line by line, which costs a tenth of a stock table."""
