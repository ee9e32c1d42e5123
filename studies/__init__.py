"""Studies: scripts behind the figures that the documentation quotes; `python -m studies` lists them."""
