"""The service that publishes scenarios and assignments."""
