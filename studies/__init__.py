"""Studies: scripts behind figures of the documentation; `python -m studies` lists them."""
