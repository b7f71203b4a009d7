"""How alembic reaches the database: through the connection that the caller hands over.

The migrations speak SQLAlchemy Core and import nothing of the application, so that an old one still means what it
meant when the application has long moved on.
"""

from alembic import context

connection = context.config.attributes["connection"]
context.configure(connection=connection, target_metadata=None, transactional_ddl=True)
with context.begin_transaction():
    context.run_migrations()
