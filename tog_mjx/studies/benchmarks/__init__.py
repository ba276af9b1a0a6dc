"""What things cost on this machine: times of rivals in one run, and the rivals themselves."""
