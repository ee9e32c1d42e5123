"""Objects on a table in physics: pictures of them, and grasps tried on them."""
