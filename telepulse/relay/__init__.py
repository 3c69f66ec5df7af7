"""A relay: displays connect to it as to a sensing node, so that they scale over machines."""
