"""The console: views of the fleet, and orders to it. Only this package imports textual."""
