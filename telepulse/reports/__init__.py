"""Reports: their document, the chapters on the paper, and the studies."""
