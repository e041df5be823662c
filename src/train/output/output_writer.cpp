#include "train/output/output_writer.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "core/text.h"
#include "model/formats/splat_formats.h"
#include "train/gaussians/gaussian_model.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_cuda.h"
#include "train/output/device_snapshot.h"
#endif

namespace b3dgs {
namespace {

using Bytes = OutputWriter::Bytes;
/// Reads an array piece by piece.
using ReadPieces = std::function<void(const char* array, std::size_t bytes, const TakePiece& take)>;

void read_host(const char* array, std::size_t bytes, const TakePiece& take) {
  constexpr std::size_t kPieceBytes = std::size_t{4} << 20;  // small enough to stay in cache for checksum and write
  for (std::size_t done = 0; done < bytes; done += kPieceBytes) {
    take(array + done, std::min(kPieceBytes, bytes - done));
  }
}

/// Appends all rows of the model to the file. `arrays` are the columns of a SplatCloud, and its filters if it has any.
void append_rows(SplatPlyWriter& file, std::int64_t n, int sh_degree, const std::vector<Bytes>& arrays,
                 const ReadPieces& read) {
  constexpr std::int64_t kBlock = 16384;
  for (std::int64_t begin = 0; begin < n; begin += kBlock) {
    const std::int64_t n_rows = std::min(kBlock, n - begin);
    SplatCloud rows;
    rows.sh_degree = sh_degree;
    std::vector<float> filters;
    std::vector<float>* const columns[]{&rows.means, &rows.log_scales, &rows.quats, &rows.logit_opacities,
                                        &rows.sh0,   &rows.shN,        &filters};
    for (std::size_t i = 0; i < arrays.size(); ++i) {
      const std::size_t row_bytes = arrays[i].size() / static_cast<std::size_t>(n);
      const char* const from = arrays[i].data() + static_cast<std::size_t>(begin) * row_bytes;
      read(from, static_cast<std::size_t>(n_rows) * row_bytes, [&](const void* piece, std::size_t bytes) {
        const auto* values = static_cast<const float*>(piece);
        columns[i]->insert(columns[i]->end(), values, values + bytes / sizeof(float));
      });
    }
    if (!filters.empty()) include_filters(filters, rows);
    file.append(rows);
  }
}

Bytes bytes_of(const torch::Tensor& tensor) {
  B3DGS_CHECK(tensor.is_contiguous(), "only contiguous tensors can be written");
  return {static_cast<const char*>(tensor.data_ptr()), tensor.nbytes()};
}

}  // namespace

/// A file that is filled from arrays and then committed.
struct OutputWriter::Content {
  std::function<void(const std::vector<Bytes>& arrays, const ReadPieces& read)> fill;
  std::function<void()> commit;
};

void OutputWriter::add(WrittenFile file, std::function<void()> work) {
  if (queue_ == nullptr) queue_ = std::make_unique<TaskQueue>(/*threads=*/1, std::numeric_limits<std::size_t>::max());
  queue_->push([this, file = std::move(file), work = std::move(work)]() mutable {
    try {
      work();
    } catch (const IoError& error) {
      file.error = error.what();
    } catch (const std::exception& error) {
      file.error = file.path.string() + ": could not be written: " + first_line(error.what());
    }
    work = {};  // frees the memory of `work` before the file counts as done
    const std::lock_guard lock(mutex_);
    done_.push_back(std::move(file));
  });
}

void OutputWriter::write(WrittenFile file, const std::function<Content()>& open,
                         const std::vector<torch::Tensor>& tensors, [[maybe_unused]] bool may_copy) {
  try {
    std::vector<Bytes> arrays;
    arrays.reserve(tensors.size());
    for (const torch::Tensor& tensor : tensors) arrays.push_back(bytes_of(tensor));
    const Content content = open();
#if B3DGS_TORCH_CUDA
    if (device_.is_cuda()) return write_from_device(file, content, arrays, may_copy);
#endif
    content.fill(arrays, read_host);
    add(std::move(file), content.commit);
  } catch (const IoError& error) {
    file.error = error.what();
    const std::lock_guard lock(mutex_);
    done_.push_back(std::move(file));
  }
}

#if B3DGS_TORCH_CUDA
void OutputWriter::write_from_device(const WrittenFile& file, const Content& content, const std::vector<Bytes>& arrays,
                                     bool may_copy) {
  const cudaStream_t stream = torch_stream();
  if (reader_ == nullptr) reader_ = std::make_shared<cuda::DeviceReader>();
  const ReadPieces read = [this](const char* array, std::size_t bytes, const TakePiece& take) {
    reader_->read(array, bytes, take);
  };
  std::shared_ptr<cuda::DeviceSnapshot> snapshot;
  if (may_copy) snapshot = cuda::make_device_snapshot(arrays, stream);
  if (snapshot == nullptr) {
    wait();  // the background thread may still be using the reader
    reader_->follow(stream);
    content.fill(arrays, read);
    return add(file, content.commit);
  }
  reader_->follow(stream);
  add(file, [content, snapshot, read]() mutable {
    content.fill(snapshot->arrays, read);
    snapshot.reset();  // frees GPU memory before waiting for the disk
    content.commit();
  });
}
#endif

void OutputWriter::write_checkpoint(const WrittenFile& file, const nlohmann::ordered_json& header,
                                    const std::vector<CheckpointTensor>& tensors, bool may_copy) {
  std::vector<TensorEntry> entries;
  std::vector<torch::Tensor> here;
  std::vector<std::function<void(const TakePiece&)>> to_come;
  for (const CheckpointTensor& tensor : tensors) {
    entries.push_back(tensor.entry);
    if (tensor.read) to_come.push_back(tensor.read);
    if (!tensor.read) here.push_back(tensor.values);
  }
  const auto open = [&]() -> Content {
    const auto out = std::make_shared<CheckpointFileWriter>(file.path, header, entries);
    const auto fill = [out, to_come](const std::vector<Bytes>& arrays, const ReadPieces& read) {
      const TakePiece append = [&](const void* piece, std::size_t bytes) { out->append(piece, bytes); };
      for (const Bytes& array : arrays) read(array.data(), array.size(), append);
      for (const auto& read_tensor : to_come) read_tensor(append);
      out->finish();
    };
    return {fill, [out] { out->commit(); }};
  };
  write(file, open, here, may_copy);
}

void OutputWriter::write_ply(const WrittenFile& file, const GaussianTensors& gaussians, const CoordinateFrame& frame,
                             bool may_copy) {
  std::vector<torch::Tensor> tensors;
  for (const torch::Tensor* tensor : gaussians.all()) tensors.push_back(*tensor);
  if (gaussians.filters.defined()) tensors.push_back(gaussians.filters);
  const auto open = [&]() -> Content {
    const std::int64_t n = gaussians.size();
    const int sh_degree = sh_degree_of(gaussians);
    const auto out = std::make_shared<SplatPlyWriter>(file.path, n, sh_degree, gaussians.filters.defined(), frame);
    const auto fill = [=](const std::vector<Bytes>& arrays, const ReadPieces& read) {
      append_rows(*out, n, sh_degree, arrays, read);
    };
    return {fill, [out] { out->commit(); }};
  };
  write(file, open, tensors, may_copy);
}

std::vector<WrittenFile> OutputWriter::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(done_, {});
}

}  // namespace b3dgs
