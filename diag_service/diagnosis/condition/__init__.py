"""What estimates say of clutch and fluid."""
