"""The robot's procedures as Diagrams wired from the blocks, and functions that run them."""
