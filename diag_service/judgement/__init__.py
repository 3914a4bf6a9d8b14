"""What estimates are worth and what they say of clutch and fluid."""
