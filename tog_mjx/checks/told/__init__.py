"""What is told: findings, and the verdict that follows from them."""
