"""Rules and tables that decide what is safe: failsafes, preflight, geofence, monitors; pure."""
