#include "train/images/image_reader.h"

#include <utility>

#include "core/parallel.h"

namespace b3dgs {

int reading_threads(ReadingLoad load) {
  constexpr int kMost = 24;  // because decoding a JPEG of 1600 px takes 10 to 15 ms, and the fastest steps take 1 ms
  if (load == ReadingLoad::kCpuTraining) return 1;
  int n_threads = thread_count() - 1;
  // The thread that launches kernels loses time to other threads on its core, and a core runs two hardware threads.
  if (load == ReadingLoad::kGpuTraining) n_threads = std::max(std::min(n_threads, 7), thread_count() / 2);
  return std::clamp(n_threads, 1, kMost);
}

ImageReader::ImageReader(Setup setup) : setup_(std::move(setup)), slots_(n_buffers()), buffers_(setup_.buffers.size()) {
  B3DGS_CHECK(n_buffers() > 0 && setup_.n_threads > 0, n_buffers(), " buffers, ", setup_.n_threads, " threads");
  try {
    for (int i = 0; i < std::min(setup_.n_threads, n_buffers()); ++i) threads_.emplace_back([this] { run_thread(); });
  } catch (...) {
    stop();
    throw;
  }
}

ImageReader::~ImageReader() {
  stop();
}

void ImageReader::stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_stopping_ = true;
  }
  work_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void ImageReader::expect(const std::vector<std::int32_t>& images) {
  std::size_t n_unread = 0;
  std::vector<std::int32_t> wanted;
  for (std::size_t i = 0; i < images.size() && wanted.size() < buffers_.size(); ++i) {
    if (std::find(wanted.begin(), wanted.end(), images[i]) == wanted.end()) wanted.push_back(images[i]);
  }
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    slots_.assign(wanted);
    order_.clear();
    for (const std::int32_t image : wanted) {
      order_.push_back(slots_.slot_of(image));
      if (has_to_be_read(order_.back())) ++n_unread;
    }
  }
  // Wakes one thread per image, because waking all of them at every step would delay the training thread.
  for (std::size_t i = 0; i < std::min(n_unread, threads_.size()); ++i) work_.notify_one();
}

bool ImageReader::has_to_be_read(int buffer) const {
  const Buffer& found = buffers_[static_cast<std::size_t>(buffer)];
  return !found.is_written && found.content != slots_.view_in(buffer);
}

const ImageReader::Buffer* ImageReader::find_read(std::int32_t image) const {
  const int slot = slots_.slot_of(image);
  const Buffer* const buffer = slot < 0 ? nullptr : &buffers_[static_cast<std::size_t>(slot)];
  return buffer != nullptr && buffer->content == image ? buffer : nullptr;
}

bool ImageReader::is_ready(std::int32_t image) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const Buffer* const buffer = find_read(image);
  return buffer != nullptr && !buffer->error;
}

int ImageReader::wait(std::int32_t image) const {
  std::unique_lock<std::mutex> lock(mutex_);
  const int slot = slots_.slot_of(image);
  B3DGS_CHECK(find_read(image) != nullptr || std::find(order_.begin(), order_.end(), slot) != order_.end(), "image ",
              image, " was not expected");
  done_.wait(lock, [&] { return find_read(image) != nullptr; });
  if (find_read(image)->error) std::rethrow_exception(find_read(image)->error);
  return slot;
}

void ImageReader::run_thread() {
  set_thread_count(1);  // decoding must not start further threads
  std::unique_lock<std::mutex> lock(mutex_);
  for (;;) {
    auto next = order_.end();
    work_.wait(lock, [&] {
      next = std::find_if(order_.begin(), order_.end(), [&](int slot) { return has_to_be_read(slot); });
      return is_stopping_ || next != order_.end();
    });
    if (is_stopping_) return;
    const int slot = *next;
    const std::int32_t image = slots_.view_in(slot);
    Buffer& buffer = buffers_[static_cast<std::size_t>(slot)];
    buffer = {UploadSlots::kEmpty, /*is_written=*/true, nullptr};
    lock.unlock();
    std::exception_ptr error;
    try {
      if (setup_.before_write) setup_.before_write(slot);
      setup_.images[static_cast<std::size_t>(image)]->read_into(setup_.buffers[static_cast<std::size_t>(slot)]);
    } catch (...) {
      error = std::current_exception();
    }
    lock.lock();
    buffer = {image, /*is_written=*/false, error};
    done_.notify_all();
  }
}

ImageBuffers::ImageBuffers(const std::vector<std::shared_ptr<const ViewImage>>& images) {
  ImageMemory* memory = nullptr;
  for (const auto& image : images) {
    n_bytes_ = std::max(n_bytes_, image->n_bytes());
    if (image->memory() != nullptr) memory = image->memory();
  }
  const int most = memory == nullptr ? ImageMemory::kMaxBuffers : memory->n_buffers();
  count_ = std::min(most, static_cast<int>(images.size()));
  if (memory != nullptr) in_use_ = memory->use_buffers(count_ * n_bytes_);
}

std::vector<std::uint8_t*> ImageBuffers::allocate() {
  memory_.reset(new std::uint8_t[static_cast<std::size_t>(count_ * n_bytes_)]);
  std::vector<std::uint8_t*> buffers(static_cast<std::size_t>(count_));
  for (int i = 0; i < count_; ++i) buffers[static_cast<std::size_t>(i)] = memory_.get() + i * n_bytes_;
  return buffers;
}

void read_in_order(const std::vector<std::shared_ptr<const ViewImage>>& images, int n_threads,
                   const std::function<void(std::size_t, const std::uint8_t*)>& body) {
  // Images in memory are never released while a scene is in use.
  std::vector<std::shared_ptr<const Image8>> held;
  std::vector<std::shared_ptr<const ViewImage>> on_disk;
  std::vector<std::int32_t> left;  // indices of the images on disk that are still to be used
  for (const auto& image : images) {
    held.push_back(image->held());
    if (held.back()) continue;
    on_disk.push_back(image);
    left.push_back(static_cast<std::int32_t>(held.size()) - 1);
  }
  std::unique_ptr<ImageBuffers> buffers;
  std::unique_ptr<ImageReader> reader;
  if (!on_disk.empty()) {
    buffers = std::make_unique<ImageBuffers>(on_disk);
    reader = std::make_unique<ImageReader>(ImageReader::Setup{images, buffers->allocate(), n_threads, {}});
  }
  for (std::size_t i = 0; i < images.size(); ++i) {
    if (held[i]) {
      body(i, held[i]->pixels.data());
      continue;
    }
    reader->expect(left);
    body(i, reader->bytes(reader->wait(left.front())));
    left.erase(left.begin());
  }
}

}  // namespace b3dgs
