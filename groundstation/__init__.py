"""The ground station: the operator's client, console, missions, records and the covey command."""
