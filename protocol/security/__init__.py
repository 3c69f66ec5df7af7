"""Protection of links: keys, authentication, connection and subscription budgets."""
