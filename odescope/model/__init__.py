"""Relations and models A(x, u) y' = b(x, u), their explicit form, and their simulation."""
