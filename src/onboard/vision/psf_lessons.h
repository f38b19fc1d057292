// SPDX-License-Identifier: Apache-2.0
// What bright stars teach of the point-spread function: the belief, the few lessons of the last frame, and the belief
// before them, so that a frame can be taken back or a spot's lesson replaced. docs/theory/vision.md, Learning.
#pragma once

#include <array>

#include "onboard/vision/psf_fit.h"
#include "onboard/vision/psf_model.h"

namespace astronav::vision {

class PsfLessons {
 public:
  PsfLessons(const SensorModel& sensor, int width_px, int height_px)
      : belief_(sensor, width_px, height_px), before_(belief_) {}

  const PsfBelief& belief() const { return belief_; }
  // Without what the last frame taught.
  const PsfBelief& before() const { return count_ > 0 ? before_ : belief_; }

  void begin_frame() { count_ = tried_ = 0; }
  // Whether this frame may teach more, and this spot is bright enough for it.
  bool wants(const PsfFit& fit) const;
  // A spot that was looked at for it, and what it says, if anything; `resolved` as in PsfBelief.
  void offer(Pixel place, const PsfEvidence* evidence, bool resolved);
  // The frame is done.
  void learn();
  // What a resolved spot of the last frame says when it is fitted as a disc.
  void replace(Pixel place, const PsfEvidence& evidence);
  // The last frame was never seen.
  void take_back();
  void forget();

 private:
  struct Lesson {
    Pixel place;
    PsfEvidence evidence;
    bool resolved = false;
  };
  // Some dozens settle the belief; then one a frame, of at most two stars that are tried, follows its drift.
  static constexpr std::size_t kFirst = 48;
  PsfBelief belief_, before_;
  std::array<Lesson, 4> lessons_;
  std::size_t count_ = 0, tried_ = 0, learnt_ = 0;
};

}  // namespace astronav::vision
