"""The robot's procedures as Diagrams, wired from the blocks, and how they are run to their end."""
