"""Speed of graspmap against the usual tools, on the same work in one run."""
