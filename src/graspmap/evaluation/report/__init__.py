"""The report of an evaluation: one page that needs nothing but itself, and its gallery of scenes."""
