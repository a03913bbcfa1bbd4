"""RTK corrections: read once for the fleet, judged by each agent, given to its PX4 in fragments."""
