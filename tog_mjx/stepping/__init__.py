"""One time step and many, and their derivatives."""
