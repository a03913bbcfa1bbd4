"""Who may join the bus and say what: certificates, roles, signatures of orders, keys of MAVLink."""
