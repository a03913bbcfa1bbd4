"""Screens that lie over the console: help, alarms, preview of an order, page of a vehicle."""
