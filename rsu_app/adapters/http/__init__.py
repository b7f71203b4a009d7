"""HTTP: people, other machines, and vehicles over cellular."""
