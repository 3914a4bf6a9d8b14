"""What makes life hard for those who analyse many logs: one that ends its process."""
