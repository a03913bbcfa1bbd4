"""What a fleet has shown in flights in which something failed, put together for an authority."""
