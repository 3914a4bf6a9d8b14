"""The services of ISO 14229-1, one function each: a call in, what is answered and remembered out."""
