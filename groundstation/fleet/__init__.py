"""The fleet as the ground sees it: a frozen value, folded from the bus."""
