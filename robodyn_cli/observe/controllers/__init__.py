"""What is stored and told of controllers: what they are, and what they did."""
