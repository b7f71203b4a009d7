"""The wheel and its extras, seen from outside the checkout."""
