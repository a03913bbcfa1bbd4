"""Flight records (``flight.mcap``): written, read, reported and replayed."""
