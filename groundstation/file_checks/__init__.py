"""What is wrong with a fleet or mission file, and whether it can be flown as configured."""
