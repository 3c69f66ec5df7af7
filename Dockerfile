FROM python:3.11-slim-bookworm AS build

WORKDIR /src
COPY . .
RUN python -m venv /opt/telepulse \
    && /opt/telepulse/bin/pip install --no-cache-dir -c constraints.txt '.[view,metrics]'

FROM python:3.11-slim-bookworm

ENV PYTHONUNBUFFERED=1 PATH=/opt/telepulse/bin:$PATH
RUN useradd --create-home telepulse
COPY --from=build /opt/telepulse /opt/telepulse

# Away from the source, so that what runs is what was installed.
WORKDIR /telepulse
COPY scenes scenes
RUN install -d -m 700 -o telepulse keys
USER telepulse
# The kernels of the prediction, into the user's cache: a container starts without compiling them, on
# processors like the one that built the image.
RUN python -c "import display_node.prediction.ensemble"

# 5555 data, 5556 control
EXPOSE 5555 5556
CMD ["telepulse", "demo"]
