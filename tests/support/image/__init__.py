"""What a container engine would make of Dockerfile, .dockerignore and docker-compose.yml, without one."""
