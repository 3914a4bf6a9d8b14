"""Pages for browsers: what they are made of, pictures as SVG, templates and one style sheet for all."""
