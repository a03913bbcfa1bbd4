"""Fleet files as frozen, checked values."""
