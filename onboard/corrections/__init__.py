"""RTK corrections: read once for the fleet, checked by each agent, sent to PX4 in fragments."""
