"""One vehicle's agent: the process that runs on each drone's computer."""
