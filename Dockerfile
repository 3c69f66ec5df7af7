FROM python:3.11-slim-bookworm

ENV PYTHONUNBUFFERED=1
RUN useradd --create-home telepulse

WORKDIR /src
COPY . .
RUN pip install --no-cache-dir -c constraints.txt .

# Away from the source, so that what runs is what was installed.
WORKDIR /telepulse
COPY scenes scenes
RUN install -d -m 700 -o telepulse keys
USER telepulse

# 5555 data, 5556 control
EXPOSE 5555 5556
CMD ["telepulse", "demo"]
