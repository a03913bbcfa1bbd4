"""Sources of motion-capture poses, and the relay that puts them on the bus."""
