// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_lessons.h"

namespace astronav::vision {

bool PsfLessons::wants(const PsfFit& fit) const {
  constexpr double kLeastSnr = 150.0;  // a star that shows the point-spread function beyond its core
  constexpr std::size_t kTriesLater = 2;
  const bool young = learnt_ < kFirst;
  const std::size_t room = young ? lessons_.size() : 1;
  return count_ < room && (young || tried_ < kTriesLater) && fit.flux_dn >= kLeastSnr * fit.flux_sigma_dn;
}

void PsfLessons::offer(Pixel place, const PsfEvidence* evidence, bool resolved) {
  ++tried_;
  if (evidence != nullptr && count_ < lessons_.size()) lessons_[count_++] = {place, *evidence, resolved};
}

void PsfLessons::learn() {
  if (count_ > 0) before_ = belief_;
  for (std::size_t i = 0; i < count_; ++i) belief_.learn(lessons_[i].place, lessons_[i].evidence, lessons_[i].resolved);
  learnt_ += count_;
}

void PsfLessons::replace(Pixel place, const PsfEvidence& evidence) {
  constexpr double kSamePx = 1.0;
  for (std::size_t i = 0; i < count_; ++i) {
    Lesson& lesson = lessons_[i];
    if (!lesson.resolved || (lesson.place.vec() - place.vec()).norm() > kSamePx) continue;
    lesson.evidence = evidence;
    belief_ = before_;
    learnt_ -= count_;
    learn();
  }
}

void PsfLessons::take_back() {
  if (count_ == 0) return;
  belief_ = before_;
  learnt_ -= count_;
  count_ = 0;
}

void PsfLessons::forget() {
  belief_.forget();
  learnt_ = 0;
}

}  // namespace astronav::vision
