"""Results of a diagnosis and what follows from many: records, courses, prognosis, pictures; for service and fleet."""
