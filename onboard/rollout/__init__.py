"""The pipeline over many vehicles at once, interpreted or compiled; pure."""
