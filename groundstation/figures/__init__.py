"""The paper's figures for a recorded flight; one module per figure, all drawn from
:class:`FlightData`.
"""
