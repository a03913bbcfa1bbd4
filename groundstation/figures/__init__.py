"""The paper's figures of a recorded flight: one module for each, all drawn from :class:`FlightData`
(``data.py``).
"""
