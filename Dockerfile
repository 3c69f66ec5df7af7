FROM python:3.11-slim-bookworm

ENV PYTHONUNBUFFERED=1
WORKDIR /telepulse
COPY . .
RUN pip install --no-cache-dir -c constraints.txt . && useradd --create-home telepulse
USER telepulse

# 5555 data, 5556 control
EXPOSE 5555 5556
CMD ["telepulse", "demo"]
