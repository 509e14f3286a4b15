"""Equations of motion; each is a diffrax vector field with components on axis 0."""
