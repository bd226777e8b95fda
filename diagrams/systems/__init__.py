"""LeafSystems that wrap the models and planners, ready to be wired to a station."""
