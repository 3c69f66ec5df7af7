"""What a recording tells: gathered in one pass, in bounded memory, and written as a report."""
