"""Shows the fleet and takes orders in a browser of this machine: ``covey web``."""
