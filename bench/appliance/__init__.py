"""What the road side unit takes and needs, beside its floors and beside what others would serve the model with."""
