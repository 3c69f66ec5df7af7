"""Services of the host: real-time measures, processes beside a node, signals, output."""
