"""LeafSystems around the models and planners, to be wired to a station."""
