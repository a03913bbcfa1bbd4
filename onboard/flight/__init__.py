"""The steps of a flight as a table, and the checks of orders."""
