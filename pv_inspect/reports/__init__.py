"""What is told of a result: pages, pictures, figures."""
