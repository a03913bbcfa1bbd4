"""Security of the bus and of PX4's links: certificates, roles, signed orders, MAVLink keys."""
