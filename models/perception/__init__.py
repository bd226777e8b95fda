"""From depth pictures to the object: table, mask, footprint, cells, and the pose push after push."""
