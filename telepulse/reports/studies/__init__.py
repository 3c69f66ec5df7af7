"""Studies: questions about the system that a computation answers, each as a report."""
