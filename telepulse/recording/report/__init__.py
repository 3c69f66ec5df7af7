"""Report of a recording: findings gathered in one pass, in bounded memory, and their page."""
