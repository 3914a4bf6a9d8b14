"""A report for people: one HTML file that needs no network, with pictures as inline SVG and a table beside each."""
