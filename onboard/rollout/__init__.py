"""The control pipeline of many simulated vehicles at once, interpreted or compiled. Pure."""
