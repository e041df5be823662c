#include "train/output/output_writer.h"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>

#include "core/check.h"
#include "core/files/own_files.h"
#include "model/formats/splat_formats.h"
#include "train/gaussians/gaussian_model.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_cuda.h"
#include "train/output/device_snapshot.h"
#endif

namespace b3dgs {
namespace {

struct Bytes {
  const char* data = nullptr;
  std::size_t bytes = 0;
};

using TakePiece = std::function<void(const void*, std::size_t)>;
/// Reads an array piece by piece.
using ReadPieces = std::function<void(const char* array, std::size_t bytes, const TakePiece& take)>;

void read_host(const char* array, std::size_t bytes, const TakePiece& take) {
  constexpr std::size_t kPieceBytes = std::size_t{4} << 20;  // small enough to stay in cache for checksum and write
  for (std::size_t done = 0; done < bytes; done += kPieceBytes) {
    take(array + done, std::min(kPieceBytes, bytes - done));
  }
}

/// A file that is filled from arrays and then committed.
struct FileContent {
  virtual ~FileContent() = default;
  virtual void fill(const std::vector<Bytes>& arrays, const ReadPieces& read) = 0;
  virtual void commit() = 0;
};

class CheckpointContent final : public FileContent {
 public:
  CheckpointContent(const std::filesystem::path& path, nlohmann::ordered_json header,
                    const std::vector<TensorEntry>& entries)
      : file_(path, std::move(header), entries) {}

  void fill(const std::vector<Bytes>& arrays, const ReadPieces& read) override {
    for (const Bytes& array : arrays) {
      read(array.data, array.bytes, [&](const void* piece, std::size_t bytes) { file_.append(piece, bytes); });
    }
    file_.finish();
  }
  void commit() override { file_.commit(); }

 private:
  CheckpointFileWriter file_;
};

class PlyContent final : public FileContent {
 public:
  PlyContent(const std::filesystem::path& path, const GaussianTensors& gaussians, const CoordinateFrame& frame)
      : n_(gaussians.size()),
        sh_degree_(sh_degree_of(gaussians)),
        has_filters_(gaussians.filters.defined()),
        file_(path, n_, sh_degree_, has_filters_, frame) {}

  void fill(const std::vector<Bytes>& arrays, const ReadPieces& read) override {
    constexpr std::int64_t kBlock = 16384;
    for (std::int64_t begin = 0; begin < n_; begin += kBlock) {
      const std::int64_t n_rows = std::min(kBlock, n_ - begin);
      SplatCloud rows;
      rows.sh_degree = sh_degree_;
      std::vector<float> filters;
      std::vector<float>* const columns[]{&rows.means, &rows.log_scales, &rows.quats, &rows.logit_opacities,
                                          &rows.sh0,   &rows.shN,        &filters};
      for (std::size_t i = 0; i < arrays.size(); ++i) {
        const std::size_t row_bytes = arrays[i].bytes / static_cast<std::size_t>(n_);
        const char* const from = arrays[i].data + static_cast<std::size_t>(begin) * row_bytes;
        read(from, static_cast<std::size_t>(n_rows) * row_bytes, [&](const void* piece, std::size_t bytes) {
          const auto* values = static_cast<const float*>(piece);
          columns[i]->insert(columns[i]->end(), values, values + bytes / sizeof(float));
        });
      }
      if (has_filters_) include_filters(filters, rows);
      file_.append(rows);
    }
  }
  void commit() override { file_.commit(); }

 private:
  std::int64_t n_;
  int sh_degree_;
  bool has_filters_;
  SplatPlyWriter file_;
};

Bytes bytes_of(const torch::Tensor& tensor) {
  B3DGS_CHECK(tensor.is_contiguous(), "only contiguous tensors can be written");
  return {static_cast<const char*>(tensor.data_ptr()), static_cast<std::size_t>(tensor.nbytes())};
}

}  // namespace

struct OutputWriter::Impl {
  explicit Impl(torch::Device where) : device(where) {}

  struct Job {
    WrittenFile file;
    std::function<void()> work;
  };

  /// The background thread: one job after the other.
  void run() {
    std::unique_lock lock(mutex);
    for (;;) {
      changed.wait(lock, [&] { return is_ending || !jobs.empty(); });
      if (jobs.empty()) return;
      {
        Job job = std::move(jobs.front());
        lock.unlock();
        const std::exception_ptr own = perform(job);
        job.work = {};  // frees its memory before it counts as done
        lock.lock();
        if (own && !fault) fault = own;
        done.push_back(std::move(job.file));
      }
      jobs.pop_front();
      changed.notify_all();
    }
  }

  /// An IoError is stored in the file's `error`; any other exception is returned.
  static std::exception_ptr perform(Job& job) {
    try {
      job.work();
    } catch (const IoError& error) {
      job.file.error = error.what();
    } catch (...) {
      job.file.error = job.file.path.string() + ": could not be written";
      return std::current_exception();
    }
    return nullptr;
  }

  void add(Job job) {
    const std::lock_guard lock(mutex);
    if (!thread.joinable()) thread = std::thread([this] { run(); });
    jobs.push_back(std::move(job));
    changed.notify_all();
  }

  void note(const WrittenFile& file) {
    const std::lock_guard lock(mutex);
    done.push_back(file);
  }

  void wait() {
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return jobs.empty(); });
  }

  /// Fills the file from the arrays on this thread, or from a copy on the background thread, which commits it.
  void write(const WrittenFile& file, const std::function<std::unique_ptr<FileContent>()>& open,
             const std::vector<Bytes>& arrays, [[maybe_unused]] bool may_copy) {
    try {
      const std::shared_ptr<FileContent> content = open();
#if B3DGS_TORCH_CUDA
      if (device.is_cuda()) return write_from_device(file, content, arrays, may_copy);
#endif
      content->fill(arrays, read_host);
      add({file, [content] { content->commit(); }});
    } catch (const IoError& error) {
      WrittenFile failed = file;
      failed.error = error.what();
      note(failed);
    }
  }

#if B3DGS_TORCH_CUDA
  void write_from_device(const WrittenFile& file, const std::shared_ptr<FileContent>& content,
                         const std::vector<Bytes>& arrays, bool may_copy) {
    const cudaStream_t stream = torch_stream();
    if (reader == nullptr) reader = std::make_unique<cuda::DeviceReader>();
    const ReadPieces read = [this](const char* array, std::size_t bytes, const TakePiece& take) {
      reader->read(array, bytes, take);
    };
    std::vector<cuda::DeviceBytes> originals;
    for (const Bytes& array : arrays) originals.push_back({array.data, array.bytes});
    std::shared_ptr<cuda::DeviceSnapshot> snapshot;
    if (may_copy) snapshot = cuda::DeviceSnapshot::make(originals, stream);
    if (snapshot == nullptr) {
      wait();  // until the background thread no longer uses the reader
      reader->follow(stream);
      content->fill(arrays, read);
      return add({file, [content] { content->commit(); }});
    }
    reader->follow(stream);
    add({file, [content, snapshot, read]() mutable {
           std::vector<Bytes> copies;
           for (const cuda::DeviceBytes& copy : snapshot->arrays()) {
             copies.push_back({static_cast<const char*>(copy.data), copy.bytes});
           }
           content->fill(copies, read);
           snapshot.reset();  // frees GPU memory before waiting for the disk
           content->commit();
         }});
  }

  std::unique_ptr<cuda::DeviceReader> reader;
#endif

  const torch::Device device;
  std::mutex mutex;
  std::condition_variable changed;
  std::deque<Job> jobs;  // the first one is in progress
  std::vector<WrittenFile> done;
  std::exception_ptr fault;
  bool is_ending = false;
  std::thread thread;
};

OutputWriter::OutputWriter(torch::Device device) : impl_(std::make_unique<Impl>(device)) {}

OutputWriter::~OutputWriter() {
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->is_ending = true;
    impl_->changed.notify_all();
  }
  if (impl_->thread.joinable()) impl_->thread.join();
}

void OutputWriter::write_checkpoint(const WrittenFile& file, nlohmann::ordered_json header,
                                    const std::vector<std::pair<std::string, torch::Tensor>>& tensors, bool may_copy) {
  std::vector<TensorEntry> entries;
  std::vector<Bytes> arrays;
  for (const auto& [name, tensor] : tensors) {
    entries.push_back({name, tensor.scalar_type(), tensor.sizes().vec()});
    arrays.push_back(bytes_of(tensor));
  }
  const auto open = [&] { return std::make_unique<CheckpointContent>(file.path, std::move(header), entries); };
  impl_->write(file, open, arrays, may_copy);
}

void OutputWriter::write_checkpoint(const WrittenFile& file, nlohmann::ordered_json header,
                                    const std::vector<TensorPieces>& tensors) {
  try {
    std::vector<TensorEntry> entries;
    for (const TensorPieces& tensor : tensors) entries.push_back(tensor.entry);
    const auto content = std::make_shared<CheckpointFileWriter>(file.path, std::move(header), entries);
    for (const TensorPieces& tensor : tensors) {
      tensor.read([&](const void* piece, std::size_t bytes) { content->append(piece, bytes); });
    }
    content->finish();
    impl_->add({file, [content] { content->commit(); }});
  } catch (const IoError& error) {
    WrittenFile failed = file;
    failed.error = error.what();
    impl_->note(failed);
  }
}

void OutputWriter::write_ply(const WrittenFile& file, const GaussianTensors& gaussians, const CoordinateFrame& frame,
                             bool may_copy) {
  std::vector<Bytes> arrays;
  for (const torch::Tensor* tensor : gaussians.all()) arrays.push_back(bytes_of(*tensor));
  if (gaussians.filters.defined()) arrays.push_back(bytes_of(gaussians.filters));
  impl_->write(
      file, [&] { return std::make_unique<PlyContent>(file.path, gaussians, frame); }, arrays, may_copy);
}

bool OutputWriter::is_busy() const {
  const std::lock_guard lock(impl_->mutex);
  return !impl_->jobs.empty();
}

void OutputWriter::wait() {
  impl_->wait();
}

std::vector<WrittenFile> OutputWriter::take() {
  const std::lock_guard lock(impl_->mutex);
  if (impl_->fault) std::rethrow_exception(std::exchange(impl_->fault, nullptr));
  return std::exchange(impl_->done, {});
}

}  // namespace b3dgs
