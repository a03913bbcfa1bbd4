"""Screens in front of the console: help, alarms, preview of an order, page of a vehicle."""
