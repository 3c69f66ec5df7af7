"""What runs both nodes: scenes, virtual-time simulation, the demo, the command line."""
