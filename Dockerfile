# b3dgs for NVIDIA GPUs of compute capability 7.5 or higher. The machine needs NVIDIA's driver (580 or later) and its
# container toolkit. The image has not been built yet.
#   docker build -t b3dgs .
#   docker run --rm --gpus all -v "$PWD:/data" b3dgs train SCENE -m MODEL    # folders in the current one; for --view, add --network host
FROM debian:12 AS build
RUN apt-get update -q && apt-get install -y -q --no-install-recommends ca-certificates python3-pip wget
RUN wget -q https://developer.download.nvidia.com/compute/cuda/repos/debian12/x86_64/cuda-keyring_1.1-1_all.deb \
  && dpkg -i cuda-keyring_1.1-1_all.deb && apt-get update -q \
  && apt-get install -y -q --no-install-recommends cuda-toolkit-13-0
# LibTorch for CUDA 13.0, with NVIDIA's libraries beside it
RUN pip install --target /opt/python torch==2.11.0
WORKDIR /b3dgs
COPY . .
RUN scripts/install_packages.sh --without-libtorch
RUN cmake --preset gpu -DCMAKE_CUDA_COMPILER=/usr/local/cuda/bin/nvcc -DCMAKE_CUDA_ARCHITECTURES='75-virtual;80;90' \
  -DCMAKE_PREFIX_PATH=/opt/python/torch
RUN cmake --build --preset gpu --target b3dgs
RUN cd build/gpu && cpack -G DEB

# The package holds all but the driver. For b3dgs reconstruct, add: apt-get install colmap ffmpeg.
FROM debian:12
RUN --mount=type=bind,from=build,source=/b3dgs/build/gpu/packages,target=/packages dpkg -i /packages/b3dgs_*.deb
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
WORKDIR /data
ENTRYPOINT ["b3dgs"]
