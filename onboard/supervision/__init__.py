"""The rules of safety applied in flight: conditions that hold now, and the action carried out."""
