"""Screens that lie over the console: help, and the question before leaving."""
