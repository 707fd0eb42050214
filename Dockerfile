# docker build -t greygate . ; docker run --rm -v "$PWD:/work" greygate doctor
# The app serves the computer it runs on alone: docker run --rm --network host -v "$PWD:/work" greygate app
FROM python:3.13-slim
RUN apt-get update && apt-get install -y --no-install-recommends g++ make perl && rm -rf /var/lib/apt/lists/*
COPY . /src
RUN pip install --no-cache-dir -c /src/constraints.txt '/src[app,hardware]' && rm -rf /src
WORKDIR /work
ENTRYPOINT ["greygate"]
